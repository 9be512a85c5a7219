"""Generated towns compared with maps that people made."""
