"""One flight from the command line: its settings, processes, console, record and verdict."""
