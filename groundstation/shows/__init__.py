"""Shows of other programs: read, made flyable, and written as fleet file, mission and paths."""
