"""Empty: checkouts that were installed while the plug-in stood here look for it; it is `rtpiv_pytest`."""
