"""A benchmark of quality-diversity search: road networks, with a certified optimum for each niche."""
