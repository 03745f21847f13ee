// SPDX-License-Identifier: Apache-2.0
// A listener of a DDS participant whose callbacks for discovered readers and writers take 5 ms each.
#include <atomic>
#include <chrono>
#include <thread>

#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/domain/DomainParticipantListener.hpp>

using namespace eprosima::fastdds::dds;

struct Slow : DomainParticipantListener {
  std::atomic<int> begun{0};

  void linger() {
    ++begun;
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  }

  void on_subscriber_discovery(DomainParticipant*, eprosima::fastrtps::rtps::ReaderDiscoveryInfo&&) override {
    linger();
  }

  void on_publisher_discovery(DomainParticipant*, eprosima::fastrtps::rtps::WriterDiscoveryInfo&&) override {
    linger();
  }
};

static Slow slow;

extern "C" void listen_slowly(int domain) {
  DomainParticipantFactory::get_instance()->lookup_participant(domain)->set_listener(&slow, std::chrono::seconds(10));
}

extern "C" int callbacks_begun() { return slow.begun; }
