"""Warp device code: one physics term a file. No allocation, no launch, no policy."""

import warp as wp

# Warp greets when it starts and warns where there is no CUDA driver; a user of wrod did not ask.
wp.config.log_level = max(wp.config.log_level, wp.LOG_ERROR)
