"""Grasps of the suspended rod: where a grip holds it so that what is laid stays."""
