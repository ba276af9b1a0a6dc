"""Scenes and motions to look at: in MuJoCo's viewers, or as a GIF or a video."""

from tog_mjx.drawing.viewing.animation import check_video as check_video
from tog_mjx.drawing.viewing.animation import write_gif as write_gif
from tog_mjx.drawing.viewing.animation import write_mp4 as write_mp4
from tog_mjx.drawing.viewing.browser import show_in_browser as show_in_browser
from tog_mjx.drawing.viewing.film import film as film
from tog_mjx.drawing.viewing.playback import Live as Live
from tog_mjx.drawing.viewing.playback import Loop as Loop
from tog_mjx.drawing.viewing.rendering import Frames as Frames
from tog_mjx.drawing.viewing.rendering import render as render
from tog_mjx.drawing.viewing.shown import Motion as Motion
from tog_mjx.drawing.viewing.shown import frame_times as frame_times
from tog_mjx.drawing.viewing.shown import motion_of as motion_of
from tog_mjx.drawing.viewing.shown import read_numbers as read_numbers
from tog_mjx.drawing.viewing.shown import simulate as simulate
from tog_mjx.drawing.viewing.shown import start as start
from tog_mjx.drawing.viewing.window import check_display as check_display
from tog_mjx.drawing.viewing.window import show_in_window as show_in_window
