#pragma once

#include <string>

namespace b3dgs {

/// A socket that listens there, does not block and is not inherited by other programs; -1: cannot be had. A port that
/// another server uses is not shared.
int listen_on(const std::string& address, int port);

/// An IPv4 address by which other machines may reach this one; empty if there is none.
std::string address_of_this_machine();

/// The port of a socket that listens; 0 if unknown.
int port_of(int listener);

}  // namespace b3dgs
