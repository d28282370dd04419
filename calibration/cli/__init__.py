"""Commands that calibration adds to the toolkit."""
