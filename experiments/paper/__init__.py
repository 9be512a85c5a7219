"""The paper's study, repeated."""
