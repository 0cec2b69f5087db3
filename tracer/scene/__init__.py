"""The scene: camera, bodies, gas and light as one checked value, and the file that says them."""
