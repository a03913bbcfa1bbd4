"""Physics of the emulated vehicles: one step, contacts, wind, frames."""
