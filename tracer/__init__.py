"""Scene and rays: how the glass bends the view of the investigation plane."""
