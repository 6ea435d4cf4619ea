"""Perception: from pictures to metric patterns and measured rods."""
