"""Shows of other programs: read, made flyable, and written as a fleet file, a mission and paths."""
