"""next_camera"""
