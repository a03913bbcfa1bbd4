"""Formations: their slots, the assignment of slots to vehicles, and frames that move and turn.

Slots come from shapes, texts, images and files.
"""
