"""What delivers images: live cameras, streams, video files, folders of images."""

SILENT_S = 2.0  # a camera that has given images, and none for so long, has failed
