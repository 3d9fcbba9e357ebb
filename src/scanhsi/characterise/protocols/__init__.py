"""What each calibration takes: the targets it asks for, the exposures, the scans."""
