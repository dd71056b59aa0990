"""The study of the neutrosophic Hough transform (2018): its experiments, figures and marks."""
