"""Objects for a map: signs and lights at crossings, and who lives in the town."""
