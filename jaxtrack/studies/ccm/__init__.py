"""The study of the cloud-like model (2019): two targets that meet."""
