"""The avoidance law (OIST), pure; README.md maps the paper to the code."""
