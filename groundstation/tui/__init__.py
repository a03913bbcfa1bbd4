"""The console: what a person sees of the fleet, and the keys and words that give orders. Only this package imports textual."""
