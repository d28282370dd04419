"""Camera calibration: board corners, intrinsics and their uncertainty."""
