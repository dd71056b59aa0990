"""Safe and masked maths, assignment, bijectors and entry checks; the floor everything stands on."""
