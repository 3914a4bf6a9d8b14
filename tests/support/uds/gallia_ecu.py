"""Controllers that are not ours, gallia's random ones, as a process: what each of them has is drawn from its number."""

import argparse
import asyncio
import json
import logging
import threading
from typing import Any

import can
import isotp
from gallia.services.uds.core import service
from gallia.services.uds.server import RandomUDSServer

FIRST_ID = 0x710
RESPONSE_OFFSET = 0x40


def server_of(seed: int) -> RandomUDSServer:
    chances: Any = {"p_service": 0.6, "p_sub_function": 0.3, "p_identifier": 0.05, "p_session": 0.03}
    server = RandomUDSServer(seed, RandomUDSServer.RandomnessParameters(**chances))
    asyncio.run(server.setup())
    return server


def serve(server: RandomUDSServer, stack: isotp.NotifierBasedCanStack) -> None:
    async def answer(request: bytes) -> bytes | None:
        response = await server.respond(service.UDSRequest.parse_dynamic(request))
        return None if response is None else bytes(response.pdu)

    while True:
        request = stack.recv(block=True, timeout=1.0)
        if request is not None and (response := asyncio.run(answer(bytes(request)))) is not None:
            stack.send(response)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-i", "--interface", required=True)
    parser.add_argument("-c", "--channel", required=True)
    parser.add_argument("seeds", nargs="+", type=int)
    options = parser.parse_args()
    logging.disable(logging.CRITICAL)
    servers = [server_of(seed) for seed in options.seeds]
    with can.Bus(options.channel, options.interface) as bus, can.Notifier(bus, [], timeout=0.05) as notifier:
        for place, server in enumerate(servers):
            can_id = FIRST_ID + place
            mode = isotp.AddressingMode.Normal_11bits
            address = isotp.Address(mode, txid=can_id + RESPONSE_OFFSET, rxid=can_id)
            stack = isotp.NotifierBasedCanStack(bus, notifier, address=address, params={"tx_padding": 0})
            stack.start()
            threading.Thread(target=serve, args=(server, stack), daemon=True).start()
        has = [{str(session): sorted(map(int, found)) for session, found in one.services.items()} for one in servers]
        print(json.dumps(has), flush=True)
        threading.Event().wait()


if __name__ == "__main__":
    main()
