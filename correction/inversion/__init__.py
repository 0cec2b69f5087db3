"""From where rays land to where a point of the plane is seen: the inverse of a ray map, sheet by sheet."""
