"""Go or no-go on the ground: the facts, the rules that check them, and the report of a vehicle."""
