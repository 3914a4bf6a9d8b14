"""Whether and how the emulated controller answers testers: what attaches to a drive by its entry point."""

import os
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import can

from ecu_emulator.drive.recording import Drive
from ecu_emulator.errors import ConfigError
from ecu_emulator.live.live_drive import BusChoice
from workshop.controller.answering_tester import Answering
from workshop.controller.doip.listening import Place, parse_place, tls_node
from workshop.controller.iso14229 import DOIP_TLS_PORT
from workshop.controller.table_file import table_like

AnyPath = str | os.PathLike[str]


@dataclass(frozen=True, slots=True, kw_only=True)
class Answers:
    """How the emulated controller answers testers; each member is the option of that name.

    Attributes
    ----------
    table : path, optional
        A TOML file that describes a controller of your own.
    like : str, optional
        A controller of a real car whose data it has besides, and whose times to answer: ``vw_dsg`` or ``bmw_dkg``.
    memory : path, optional
        A file that keeps trouble codes over restarts.
    doip, elm327 : str, optional
        ``[HOST:]PORT`` at which it answers over IP, and as an ELM327 adapter.
    doip_certificate, doip_key : path, optional
        With a certificate it answers over IP by TLS as well; the key may be in the same file.
    doip_tls_port : int
        Where it does.

    Raises
    ------
    ConfigError
        If an address is none.
    """

    table: AnyPath | None = None
    like: str | None = None
    memory: AnyPath | None = None
    doip: str | None = None
    elm327: str | None = None
    doip_certificate: AnyPath | None = None
    doip_key: AnyPath | None = None
    doip_tls_port: int = DOIP_TLS_PORT

    def __post_init__(self) -> None:
        if self.table is not None and self.like is not None:
            raise ConfigError("a controller answers by a table of its own, or like another one, not both")
        if self.like is not None:
            table_like(self.like)
        self._place()

    def opened(self, bus: can.BusABC, choice: BusChoice, drive: Drive) -> Answering:
        """Return the controller that answers while it is entered.

        Raises
        ------
        ConfigError, RecordError, BusError, ExtraMissingError
            If the table, the memory, the bus or an address cannot be used, or can-isotp is not installed.
        """
        return Answering(
            bus,
            table="" if self.table is None else os.fspath(self.table),
            like=self.like or "",
            memory=self._memory,
            doip=self._place(),
            is_fd=choice.is_fd,
            elm327=self.elm327,
            bitrate=choice.bitrate,
            performer=drive,
            ignition=drive.ignition,
        )

    @property
    def _memory(self) -> Path | None:
        return None if self.memory is None else Path(self.memory)

    def _place(self) -> Place | None:
        """Return where it answers on an IP network, None if it does not."""
        certificate, key = (None if one is None else Path(one) for one in (self.doip_certificate, self.doip_key))
        if certificate is None and self.doip_tls_port != DOIP_TLS_PORT:
            raise ConfigError("--doip-tls-port needs --doip-certificate")
        tls = tls_node(certificate, key, self.doip_tls_port)
        if self.doip is not None:
            return replace(parse_place(self.doip), tls=tls)
        if tls is not None:
            raise ConfigError("--doip-certificate needs --doip")
        return None


def chosen(options: SimpleNamespace) -> Answers | None:
    """Return what a command line says of it, None if nobody is to answer.

    Raises ConfigError if there is a memory or an address and nobody who uses it, or the address is none.
    """
    given = {
        "--diagnostic-memory": options.diagnostic_memory, "--doip": options.doip, "--elm327": options.elm327,
        "--doip-certificate": options.doip_certificate,
        "--doip-key": options.doip_key,
        "--doip-tls-port": None if options.doip_tls_port == DOIP_TLS_PORT else options.doip_tls_port,
    }  # fmt: skip
    if options.diagnostics is None and options.answers_like is None:
        for option, value in given.items():
            if value is not None:
                raise ConfigError(f"{option} needs --diagnostics")
        return None
    return Answers(
        table=options.diagnostics or None,
        like=options.answers_like,
        memory=options.diagnostic_memory,
        doip=options.doip,
        elm327=options.elm327,
        doip_certificate=options.doip_certificate,
        doip_key=options.doip_key,
        doip_tls_port=options.doip_tls_port,
    )
