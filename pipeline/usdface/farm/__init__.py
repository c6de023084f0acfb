"""Jobs as Open Job Description bundles, and from there to render farms."""
