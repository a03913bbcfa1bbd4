"""Go or no-go on the ground: the facts, the rules that judge them, and the report of a vehicle."""
