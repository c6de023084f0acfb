"""How far one performance is from another."""
