"""From one rig to the control vector of another."""
