"""Review of a solve: its verdict, and the moments to review first."""
