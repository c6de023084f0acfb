"""One face laid on another: clouds, surfaces and correspondences."""
