"""Agents, emulated vehicles, bus and ground in one process and in virtual time: ``covey fly
--lockstep``.
"""
