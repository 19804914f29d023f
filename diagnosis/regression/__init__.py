"""Effects that inverse dynamics are linear in, at all joints at once, from one weighted regression."""
