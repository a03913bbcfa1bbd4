"""Writes a recorded flight as one page that opens offline and plays."""
