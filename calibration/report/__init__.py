"""What a calibration found, drawn in one HTML file that needs no network and no script."""
