"""Rays to hits: sphere tree and plain reference."""
