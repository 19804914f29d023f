"""What to record next: motions that tell most of what a robot's file may lack."""
