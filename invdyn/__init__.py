"""invdyn: joint torques, with their uncertainty, from the keypoints that a camera tracks."""
