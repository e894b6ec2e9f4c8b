"""Tests of the cache, the queue and the engine."""
