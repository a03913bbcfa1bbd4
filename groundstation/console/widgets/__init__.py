"""Widgets of the console.

Most widgets draw their own lines, which is much faster than Textual's DataTable.
"""
