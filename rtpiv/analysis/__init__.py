"""Analysis of frames: calibration and evaluation of runs, pictures, report; no device is touched."""
