"""Formations.

Slots from shapes, texts, images and files; who takes which slot; frames that move, turn and scale.
"""
