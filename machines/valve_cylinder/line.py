"""A hydraulic line as three rational transfer functions fitted to its four-pole equation (thesis A.5, A.21-A.26)."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import lstsq

DC_GAIN = {"transmission": lambda line: 1.0, "impedance": lambda line: line.resistance, "admittance": lambda line: 0.0}
"""Transfer function of the four-pole matrix -> its gain at s = 0, which a fit keeps exactly."""


@dataclass(frozen=True)
class Line:
    """A line of `length` m and `diameter` m with oil of `viscosity` m^2/s, `density` kg/m^3, `bulk_modulus` Pa.

    With alpha = chi = 1 (table A.4) Gamma^2 = (length/c)^2 (s^2 + damping s), so the poles of all three functions are
    exactly the roots of s^2 + damping s + omega_n^2.
    """

    length: float = 1.0
    diameter: float = 5e-3
    viscosity: float = 1e-4
    density: float = 890.0
    bulk_modulus: float = 1.4e9

    @property
    def sound_speed(self) -> float:
        """c in m/s (A.26)."""
        return np.sqrt(self.bulk_modulus / self.density)

    @property
    def damping(self) -> float:
        """32 nu / d^2 in 1/s."""
        return 32 * self.viscosity / self.diameter**2

    @property
    def impedance(self) -> float:
        """Z_0 in Pa s/m^3 (A.25)."""
        return 4 * self.density * self.sound_speed / (np.pi * self.diameter**2)

    @property
    def resistance(self) -> float:
        """Laminar resistance in Pa s/m^3, the limit of Z_c sinh / cosh at s = 0: 128 rho nu l / (pi d^4)."""
        return self.impedance * self.damping * self.length / self.sound_speed

    def frequencies(self, modes: int) -> np.ndarray:
        """omega_n in rad/s of the first `modes` quarter-wave modes."""
        return (np.arange(modes) + 0.5) * np.pi * self.sound_speed / self.length

    def four_pole(self, s: np.ndarray) -> dict[str, np.ndarray]:
        """The three functions of (A.21) at complex `s`: 1/cosh, Z_c sinh/cosh, sinh/(Z_c cosh)."""
        loss = np.sqrt(1 + self.damping / s)
        gamma = self.length / self.sound_speed * s * loss
        characteristic = self.impedance * loss
        return {
            "transmission": 1 / np.cosh(gamma),
            "impedance": characteristic * np.tanh(gamma),
            "admittance": np.tanh(gamma) / characteristic,
        }

    def fit(self, modes: int = 3, band: float = 2 * np.pi * 1000) -> dict[str, np.ndarray]:
        """Least-squares modal gains up to `band` rad/s: function -> (modes, 2), columns a, b.

        A function is the sum over n of (a_n s omega_n + b_n omega_n^2) / (s^2 + damping s + omega_n^2).

        Strictly proper and stable by construction, so no algebraic loop closes through the valve or the pump chamber;
        the gain at s = 0 is exact.
        """
        s = 1j * np.linspace(band / 400, band, 400)
        basis = self._basis(s, modes)
        rate, level = basis[:, :modes], basis[:, modes:]
        free = np.hstack([rate, level[:, :-1] - level[:, -1:]])  # the last b makes up the gain at s = 0
        fitted = {}
        for name, exact in self.four_pole(s).items():
            gain = DC_GAIN[name](self)
            target = exact - gain * level[:, -1]
            scale = np.abs(exact).max()
            solution = lstsq(np.vstack([free.real, free.imag]), np.concatenate([target.real, target.imag]) / scale)[0]
            a, b = solution[:modes] * scale, solution[modes:] * scale
            fitted[name] = np.column_stack([a, [*b, gain - b.sum()]])
        return fitted

    def _basis(self, s: np.ndarray, modes: int) -> np.ndarray:
        s, omega = s[:, None], self.frequencies(modes)
        pole = s**2 + self.damping * s + omega**2
        return np.hstack([s * omega / pole, omega**2 / pole])
