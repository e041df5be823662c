// TCP sockets for the control connections between ranks.
#pragma once

#include <chrono>
#include <optional>
#include <string>

#include "core/descriptor.h"

namespace b3dgs {

using Socket = Descriptor;

/// Listens at this address only. Port 0: a free one. @throws InputError if the address is unknown or the port occupied
Socket listen_at(const std::string& address, int port);

int port_of(const Socket& socket);

/// The numeric address of this machine that the socket is bound to.
std::string own_address_of(const Socket& socket);

/// The network interface of this machine that has this numeric address ("lo"); "" if none has.
std::string interface_with(const std::string& own_address);

/// nullopt if nobody answers, yet. @throws InputError if the address is unknown
std::optional<Socket> try_to_connect(const std::string& address, int port, std::chrono::milliseconds limit);

}  // namespace b3dgs
