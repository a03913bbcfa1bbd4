"""Silence on the wire: what leaves an agent when something in it hangs, measured outside of it."""
