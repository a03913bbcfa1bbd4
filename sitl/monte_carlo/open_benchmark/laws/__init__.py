"""Published laws, each reimplemented from its paper with the interface of a user's own law.

Each file is one law of about thirty lines; ``around.py`` is what they share. They treat obstacles
as vehicles that stand still and do not cooperate. Each law is an entry point, so that ``--law
orca`` and ``[law] name = "orca"`` fly it.
"""
