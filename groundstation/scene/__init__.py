"""What all pages of Covey are drawn with: a scene in three dimensions, curves, and their look."""
