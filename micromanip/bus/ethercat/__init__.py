"""EtherCAT as master and emulated slaves both know it: registers, frames, states, mailbox (IEC 61158 type 12)."""
