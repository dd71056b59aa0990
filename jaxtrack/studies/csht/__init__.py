"""The study of the clustering-statistic Hough transform (2018): motion elements of a window."""
