"""Calibration of a film with reference loads: the straight line of Fig. 4 and its errors."""
