"""What a lab prints and hangs in front of its camera: boards and particles, on paper at true size."""
