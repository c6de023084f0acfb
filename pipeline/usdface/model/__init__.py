"""Trained mappings: markers to a rig's weights, fitted on references and applied to takes."""
