"""The archive of a folder of logs: a bucket of object storage that speaks S3."""
