"""Camera files of other programs: OpenCV, ROS, Kalibr and COLMAP."""
