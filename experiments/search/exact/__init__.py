"""Exact programmes that prove the optima of flawless networks.

All of them go over a grid cell by cell, and so over a layered graph. A node is a state: what the cells so far have in
common with the rest. An edge is a tile. Each programme lists the edges of a cell, finds which of them lead to the same
state (`graph.merge`), and carries values along them (`graph.carry_best`, `graph.carry_counts`).
"""
