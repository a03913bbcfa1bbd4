"""Draws what all pages of Covey share: a scene in three dimensions, curves, and their styles."""
