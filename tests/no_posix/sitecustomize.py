"""Programs that find this folder on their path begin as on a system without POSIX."""

from lacking import hide  # by this folder alone: nothing else of the project is imported

hide()
