"""One pair from frames to vectors, errors and uncertainty."""
