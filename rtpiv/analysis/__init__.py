"""What frames say: calibration and evaluation of runs, pictures, the report.  No device is touched from here."""
