"""Where the light sheet is, from the particles in it: what is seen twice tells its height."""
