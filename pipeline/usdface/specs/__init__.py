"""Job specs: one pydantic model per step; no numpy, no USD, no disk."""
