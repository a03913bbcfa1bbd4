"""Laws of other people, each written anew from its paper, with the interface of a user's own law.

Each file is one law of about thirty lines; ``around.py`` is what they share. They avoid obstacles
as vehicles that do not cooperate and stand still. Each law is an entry point, so that ``--law
orca`` and ``[law] name = "orca"`` fly it.
"""
