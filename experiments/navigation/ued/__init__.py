"""RoadUED: unsupervised environment design whose regret is exact over complete spaces of levels."""
