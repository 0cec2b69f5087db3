"""Taking frames: from a bench and a plan to a run on the disk.

    bench      which devices, where they are, and one of each opened
    plans      what to do, as a flat list of steps, before anything moves
    cameras    backends
    runner     does the steps, resumes, stops
    pipeline   every frame to the disk, and corrected as it arrives if there is time
    runs       what a run keeps, and how it is read again

Nothing here knows the analysis, which knows of all this only `runs`.
"""
