"""The console: what a person sees of the fleet, and how they give orders. Only this package imports textual."""
