"""The lanes of a map: nodes, movements and curves, in NumPy.

Formats, `drive` and `maps` read this one model.

Traffic keeps right. A movement enters a tile with a heading and turns right, goes straight on or
turns left. Headings and sides are indices of `codes.SIDES`: 0 north, 1 east, 2 south, 3 west. Turns
are 0 right, 1 straight, 2 left; formats whose cars turn back at dead ends have 3, back. Only links
count: connections that the neighbour returns.

Lengths are in tiles. x points east and y south from the north-west corner of the grid. Formats
whose y points north convert positions when they write them.
"""
