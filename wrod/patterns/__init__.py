"""Patterns: planar curves along which a rod is laid, their files and shapes."""
