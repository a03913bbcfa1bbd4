"""Orders: their words, plan, preview, forecast and result."""
