"""The study of the clustering-statistic Hough transform (2018): targets that come and go."""
