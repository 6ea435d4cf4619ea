"""Deployment in simulation: a grip lays a rod on a table, between fixtures or without."""
