"""The study of the Zernike moment paper (2023): a bucket before a scanning sonar."""
