"""Dynamic luminance textures (paper 4.2): cache, request queue, engine."""
