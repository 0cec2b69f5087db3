"""The pipeline: frames go to the disk and through the correction while the next ones are taken."""
