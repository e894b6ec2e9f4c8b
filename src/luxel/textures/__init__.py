"""Luminance textures: spec, mapping, encoding, bake."""
