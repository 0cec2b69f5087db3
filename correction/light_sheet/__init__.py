"""Position of the light sheet from its particles: those seen twice give its height."""
