"""Several cameras at one scene: calibrations read and written, pixels to points in space, poses adjusted."""
