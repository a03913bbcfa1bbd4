"""The other vehicles as this agent knows them."""
