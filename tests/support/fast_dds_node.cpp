// A node of Fast DDS, ROS 2's default middleware, that knows nothing of Tactune: it passes every payload on as it is.
//
// fast_dds_node subscribe|publish DOMAIN [TOPIC TYPE (reliable|best_effort|transient_local)]...
//
// It writes what it receives to standard output, or publishes what comes by standard input: per sample the number of its
// topic, from 0, its length (both uint32) and its bytes, the CDR header included. It ends when standard input closes.

#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <deque>
#include <functional>
#include <mutex>
#include <string>
#include <vector>

#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/DataReaderListener.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/TopicDataType.hpp>
#include <fastdds/dds/topic/TypeSupport.hpp>

using namespace eprosima::fastdds::dds;
using eprosima::fastrtps::rtps::InstanceHandle_t;
using eprosima::fastrtps::rtps::SerializedPayload_t;
using Bytes = std::vector<uint8_t>;

class RawType : public TopicDataType
{
public:

    explicit RawType(const std::string& name)
    {
        setName(name.c_str());
        m_typeSize = 1024;  // grows with the payload, see the memory policy
        m_isGetKeyDefined = false;
        auto_fill_type_object(false);  // as ROS 2 does: types match by name
        auto_fill_type_information(false);
    }

    bool serialize(void* data, SerializedPayload_t* payload) override
    {
        const Bytes& bytes = *static_cast<Bytes*>(data);
        payload->length = static_cast<uint32_t>(bytes.size());
        payload->encapsulation = CDR_LE;
        std::memcpy(payload->data, bytes.data(), bytes.size());
        return true;
    }

    bool deserialize(SerializedPayload_t* payload, void* data) override
    {
        static_cast<Bytes*>(data)->assign(payload->data, payload->data + payload->length);
        return payload->length > 0;  // 0: a large sample that was replaced before all of it came; ROS 2 drops it, too
    }

    std::function<uint32_t()> getSerializedSizeProvider(void* data) override
    {
        return [data] { return static_cast<uint32_t>(static_cast<Bytes*>(data)->size()); };
    }

    void* createData() override
    {
        return new Bytes;
    }

    void deleteData(void* data) override
    {
        delete static_cast<Bytes*>(data);
    }

    bool getKey(void*, InstanceHandle_t*, bool) override
    {
        return false;
    }
};

class Listener : public DataReaderListener
{
public:

    explicit Listener(uint32_t topic) : topic_(topic)
    {
    }

    void on_data_available(DataReader* reader) override
    {
        static std::mutex output;
        Bytes bytes;
        SampleInfo info;
        while (reader->take_next_sample(&bytes, &info) == ReturnCode_t::RETCODE_OK)
        {
            if (info.valid_data)
            {
                std::lock_guard<std::mutex> guard(output);
                const uint32_t head[2] = {topic_, static_cast<uint32_t>(bytes.size())};
                std::fwrite(head, sizeof head, 1, stdout);
                std::fwrite(bytes.data(), 1, bytes.size(), stdout);
                std::fflush(stdout);
            }
        }
    }

private:

    uint32_t topic_;
};

template <class Qos>
void set(Qos& qos, const std::string& name)
{
    qos.reliability().kind = name == "best_effort" ? BEST_EFFORT_RELIABILITY_QOS : RELIABLE_RELIABILITY_QOS;
    qos.durability().kind = name == "transient_local" ? TRANSIENT_LOCAL_DURABILITY_QOS : VOLATILE_DURABILITY_QOS;
    qos.history().kind = KEEP_LAST_HISTORY_QOS;
    qos.history().depth = 5;
    qos.endpoint().history_memory_policy = eprosima::fastrtps::rtps::PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
}

int main(int count, char** words)
{
    if (count < 6 || count % 3 != 0)
    {
        std::fprintf(
            stderr, "usage: %s subscribe|publish DOMAIN [TOPIC TYPE reliable|best_effort|transient_local]...\n", words[0]);
        return 2;
    }
    const bool publishes = std::string(words[1]) == "publish";
    DomainParticipantFactory* factory = DomainParticipantFactory::get_instance();
    DomainParticipant* participant = factory->create_participant(std::atoi(words[2]), PARTICIPANT_QOS_DEFAULT);
    Subscriber* subscriber = participant->create_subscriber(SUBSCRIBER_QOS_DEFAULT);
    Publisher* publisher = participant->create_publisher(PUBLISHER_QOS_DEFAULT);
    std::deque<Listener> listeners;
    std::vector<DataWriter*> writers;
    for (int i = 3; i < count; i += 3)
    {
        TypeSupport(new RawType(words[i + 1])).register_type(participant);
        Topic* topic = participant->create_topic(words[i], words[i + 1], TOPIC_QOS_DEFAULT);
        if (publishes)
        {
            DataWriterQos qos = DATAWRITER_QOS_DEFAULT;
            set(qos, words[i + 2]);
            qos.publish_mode().kind = ASYNCHRONOUS_PUBLISH_MODE;  // as ROS 2 does; needed for what exceeds a datagram
            writers.push_back(publisher->create_datawriter(topic, qos));
            continue;
        }
        DataReaderQos qos = DATAREADER_QOS_DEFAULT;
        set(qos, words[i + 2]);
        listeners.emplace_back(static_cast<uint32_t>(listeners.size()));
        if (subscriber->create_datareader(topic, qos, &listeners.back()) == nullptr)
        {
            std::fprintf(stderr, "no reader of %s\n", words[i]);
            return 1;
        }
    }
    uint32_t head[2];
    Bytes bytes;
    while (std::fread(head, sizeof head, 1, stdin) == 1)
    {
        bytes.resize(head[1]);
        if (std::fread(bytes.data(), 1, bytes.size(), stdin) == bytes.size())
        {
            writers.at(head[0])->write(&bytes);
        }
    }
    participant->delete_contained_entities();
    factory->delete_participant(participant);
    return 0;
}
