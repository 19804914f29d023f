"""From a film to keypoints: pictures decoded, networks trained on labels, joints tracked."""
