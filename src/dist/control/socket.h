// TCP sockets for the control connections between ranks.
#pragma once

#include <chrono>
#include <optional>
#include <string>

#include "core/descriptor.h"

namespace b3dgs {

using Socket = Descriptor;

/// Listens only at this address. Port 0 means a free one. @throws InputError for an unknown address or a port in use
Socket listen_at(const std::string& address, int port);

int port_of(const Socket& socket);

/// Returns the numeric address of this machine that the socket is bound to.
std::string own_address_of(const Socket& socket);

/// Returns the network interface of this machine that has this numeric address ("lo"), or "".
std::string interface_with(const std::string& own_address);

/// Returns nullopt if nobody answers yet. @throws InputError if the address is unknown
std::optional<Socket> try_to_connect(const std::string& address, int port, std::chrono::milliseconds limit);

}  // namespace b3dgs
