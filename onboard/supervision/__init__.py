"""The rules of safety applied at each tick: which conditions hold now, and what follows."""
