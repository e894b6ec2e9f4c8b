"""The store: baked textures on disk, with all that pictures of them need, as a Zarr directory (``docs/baking.md``)."""
