"""Laws of other people, each written anew from its paper, behind the door for everybody's own law.

Each file is one law of about thirty lines; ``around.py`` is what they share. They avoid obstacles
as vehicles that do not cooperate and stand still. All have the names of entry points, so that
``--law orca`` and ``[law] name = "orca"`` fly them.
"""
