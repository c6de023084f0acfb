"""Which frames to tune, and what references cover."""
