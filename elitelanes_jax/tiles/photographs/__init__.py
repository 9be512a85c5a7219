"""From photographs of tiles to a tile set, and to the map of a laid floor."""
