"""A fleet's own authority, and the certificates of its nodes."""
