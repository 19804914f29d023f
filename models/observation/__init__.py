"""What sensors see of a body: pixels of cameras."""
