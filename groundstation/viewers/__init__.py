"""A recorded flight as the viewers of other people read it: Foxglove, Lichtblick, Rerun."""
