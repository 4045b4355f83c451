from .machines import machine

__all__ = ["machine"]
