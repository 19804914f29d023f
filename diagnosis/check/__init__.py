"""What a log can show, and what is wrong with it, in seconds and before causes."""
