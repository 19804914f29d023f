"""What a log can be asked, and what is wrong with it, in seconds and before causes."""
