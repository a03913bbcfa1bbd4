"""The open benchmark: scenes in JSON files, flown by any law, and a table of the results."""
