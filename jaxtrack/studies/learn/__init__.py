"""The study of learning through the tracker: a network that gives each echo a weight."""
