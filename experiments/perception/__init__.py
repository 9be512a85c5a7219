"""Pictures: what a network learns from them, and how they are drawn."""
