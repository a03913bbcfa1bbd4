"""Widgets of the console.

Most widgets draw their own lines, which takes a tenth of the time of Textual's DataTable.
"""
