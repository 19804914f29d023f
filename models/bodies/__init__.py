"""What a body is made of: links, joints and sites in space, and the files that say it."""
